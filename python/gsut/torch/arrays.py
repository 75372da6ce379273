"""Tensors to arrays and back without a copy: by DLPack, any build of torch with any NumPy."""

from __future__ import annotations

import numpy as np
import torch

from gsut import InputError


def to_array(tensor: torch.Tensor, name: str) -> np.ndarray:
    """Reads a tensor as an array that shares its memory, where its layout is C-contiguous.

    Args:
        tensor: on the CPU; its gradient is not followed.
        name: what errors call it.

    Raises:
        InputError: it lies on a device, or is not float32 or float64.
    """
    if tensor.device.type != "cpu":
        raise InputError(f"{name} is on {tensor.device}: gsut runs on the CPU; call .cpu()")
    if tensor.dtype not in (torch.float32, torch.float64):
        raise InputError(f"{name} is {tensor.dtype}: convert it to float32 or float64")
    if tensor.numel() == 0:  # DLPack of some builds has no empty tensors
        dtype = np.float64 if tensor.dtype == torch.float64 else np.float32
        return np.zeros(tuple(tensor.shape), dtype)
    return np.from_dlpack(tensor.detach().contiguous())


def to_tensor(array: np.ndarray) -> torch.Tensor:
    """Reads a writable array as a tensor that shares its memory, where it is C-contiguous."""
    if array.size == 0:
        kinds = {"float64": torch.float64, "int64": torch.int64, "int32": torch.int32}
        return torch.zeros(array.shape, dtype=kinds.get(str(array.dtype), torch.float32))
    return torch.from_dlpack(np.ascontiguousarray(array))
