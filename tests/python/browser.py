"""A headless Chromium, steered by its driver over HTTP: pages as people see them."""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import gsut

_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
    "--disable-sync", "--hide-scrollbars", "--force-color-profile=srgb",
)  # fmt: skip
WAIT_SECONDS = 60.0
_CANVAS_PIXELS = """
  const canvas = document.getElementById("canvas");
  const copy = new OffscreenCanvas(canvas.width, canvas.height);
  const brush = copy.getContext("2d", { willReadFrequently: true });
  brush.drawImage(canvas, 0, 0);
  const data = brush.getImageData(0, 0, canvas.width, canvas.height).data;
  return [canvas.width, canvas.height, Array.from(data)];"""


class Browser:
    """One window.

    Args:
        address: of the driver's session.
    """

    def __init__(self, address: str) -> None:
        self._address = address

    def _ask(self, path: str, values: dict[str, Any] | None = None) -> Any:
        data = None if values is None else json.dumps(values).encode()
        request = urllib.request.Request(self._address + path, data)
        with urllib.request.urlopen(request, timeout=WAIT_SECONDS) as reply:
            return json.loads(reply.read())["value"]

    def open(self, address: str) -> None:
        self._ask("/url", {"url": address})

    def run(self, script: str) -> Any:
        """The value of a script, which may await."""
        script = (
            "const done = arguments[0];"
            f"(async () => {{ {script} }})().then(done, (error) => done('failed: ' + error));"
        )
        return self._ask("/execute/async", {"script": script, "args": []})

    def wait(self, condition: str) -> None:
        """Until an expression of the page is true."""
        end = time.monotonic() + WAIT_SECONDS
        while not self.run(f"return Boolean({condition});"):
            assert time.monotonic() < end, f"never true: {condition}"
            time.sleep(0.05)

    def errors(self) -> list[str]:
        """What the page's console holds of errors and warnings."""
        rows = self._ask("/se/log", {"type": "browser"})
        return [row["message"] for row in rows if row["level"] in ("SEVERE", "WARNING")]

    def resize(self, width: int, height: int) -> None:
        self._ask("/window/rect", {"width": width, "height": height})

    def picture(self) -> bytes:
        """A PNG of the window."""
        return base64.b64decode(self._ask("/screenshot"))

    def read_canvas(self) -> np.ndarray:
        """The pixels of the page's canvas, (H, W, 4) uint8."""
        width, height, data = self.run(_CANVAS_PIXELS)
        return np.array(data, np.uint8).reshape(height, width, 4)

    def read_gaussians(self) -> gsut.Gaussians:
        """The Gaussians that a page of one file holds."""
        parts = self.run("""
          const text = (array) => {
            const bytes = new Uint8Array(array.buffer), pieces = [];
            for (let i = 0; i < bytes.length; i += 30000) {
              pieces.push(String.fromCharCode(...bytes.subarray(i, i + 30000)));
            }
            return btoa(pieces.join(""));
          };
          return server.gaussians.parts.map(text);""")
        means, quats, scales, logits, sh = (
            np.frombuffer(base64.b64decode(text), np.float32) for text in parts
        )
        n = len(logits)
        origin = np.array(self.run("return server.content.origin;"))
        return gsut.Gaussians(
            means.reshape(n, 3), quats.reshape(n, 4), scales.reshape(n, 3), logits,
            sh.reshape(n, -1, 3), origin,
        )  # fmt: skip

    def devtools(self, command: str, **values: Any) -> Any:
        return self._ask("/goog/cdp/execute", {"cmd": command, "params": values})


def _start(driver: str) -> tuple[subprocess.Popen[str], str]:
    """A running driver and its port. Beside other tests a driver has been seen to end before it had
    a port, so one that ends is started again, and what all said is in the error."""
    said: list[str] = []
    for _ in range(5):
        process = subprocess.Popen(
            [driver, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert process.stdout is not None
        for line in process.stdout:
            said.append(line)
            if "successfully on port" in line:
                return process, line.rstrip(".\n").split()[-1]
        _stop(process)
        said.append(f"(ended with {process.returncode})\n")
    raise RuntimeError(f"{driver} does not start:\n{''.join(said)}")


def _stop(process: subprocess.Popen[str]) -> None:
    process.terminate()
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


@contextlib.contextmanager
def browser(
    width: int = 1280, height: int = 800, more_flags: tuple[str, ...] = ()
) -> Iterator[Browser]:
    """A browser; the test is skipped where there is none."""
    driver, program = shutil.which("chromedriver"), shutil.which("chromium")
    if driver is None or program is None:
        pytest.skip("chromium and chromium-driver are not installed")
    with tempfile.TemporaryDirectory(prefix="gsut-browser-", ignore_cleanup_errors=True) as folder:
        process, port = _start(driver)
        try:
            address = f"http://127.0.0.1:{port}/session"
            flags = [*_FLAGS, f"--user-data-dir={folder}", f"--window-size={width},{height}",
                     *more_flags]  # fmt: skip
            wanted = {
                "goog:chromeOptions": {"binary": program, "args": flags},
                "goog:loggingPrefs": {"browser": "ALL"},
                "timeouts": {"script": int(1000 * WAIT_SECONDS)},
            }
            asked = json.dumps({"capabilities": {"alwaysMatch": wanted}}).encode()
            with urllib.request.urlopen(urllib.request.Request(address, asked)) as reply:
                session = json.loads(reply.read())["value"]["sessionId"]
            one = Browser(f"{address}/{session}")
            yield one
            with contextlib.suppress(OSError):
                urllib.request.urlopen(
                    urllib.request.Request(f"{address}/{session}", method="DELETE"), timeout=10
                ).close()
        finally:
            _stop(process)
