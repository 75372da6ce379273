"""Measures how much of a photograph's detail a render shows in the right place.

PSNR falls with fog in a sky and with brightness as much as with blur. The contrast and structure
term of SSIM (Wang et al., 2004) compares what an eye calls sharp: local contrast, not its level.
"""

from __future__ import annotations

import numpy as np

# Longer side in pixels at which pictures are compared: that of a picture on a page.
_SIDE = 800
# Standard deviation in pixels of the window in which contrast is measured, as in SSIM.
_WINDOW = 1.5
# Contrast, of full scale, below which a place shows no detail: SSIM's constant K2.
_CONTRAST = 0.03
# Standard deviation, of the longer side, of the window whose mean is taken away: a blur counts by
# its share of the picture, so that it is seen in a small one, too.
_COARSE = 0.01
# The same in pixels, at least.
_COARSE_PX = 1.0
# Sum of weights that divides nothing by zero.
_FEW_WEIGHTS = 1e-6
# Contrast-structure term above which a detail is right: half of a perfect one.
_RIGHT = 0.5
# Standard deviation in pixels of what is taken away before pictures are registered: their level.
_LEVEL = 5.0
# Side in pixels below which pictures are not registered.
_SMALLEST = 16


def measure_detail(photograph: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Measures the share of a photograph's detail that a render shows in the right place.

    Args:
        photograph: (H, W, 3) uint8.
        image: (H, W, 3) of the render in [0, 1], in the photograph's light.
        mask: (H, W) bool; True where pixels count.

    Returns:
        From 0 to 1, of the pixels whose surroundings have contrast; of all pixels where none have.
    """
    return _Detail(_average_photograph(photograph), mask).measure(_average_channels(image))


def measure_details(
    photograph: np.ndarray, image: np.ndarray, mask: np.ndarray
) -> tuple[float, float]:
    """Measures the detail that is right as it is, and after the render is shifted as a whole.

    Where a pose or a lens is wrong, a shift brings detail back; blur, holes and what moved it does
    not mend.

    Args:
        photograph, image, mask: see `measure_detail`.

    Returns:
        The result of `measure_detail`, and the detail of the render shifted by what phase
        correlation finds; the first again if that is more.
    """
    import cv2

    truth, shown = _average_photograph(photograph), _average_channels(image)
    detail = _Detail(truth, mask)
    plain = detail.measure(shown)
    if min(mask.shape) < _SMALLEST:
        return plain, plain
    weight = mask.astype(np.float32)

    def flatten(grey: np.ndarray) -> np.ndarray:
        inside = grey * weight
        return inside - _average(inside, _LEVEL)

    size = mask.shape[1], mask.shape[0]
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    (right, down), _ = cv2.phaseCorrelate(flatten(shown), flatten(truth), window)
    move = np.array([[1, 0, right], [0, 1, down]], np.float32)
    shifted = cv2.warpAffine(shown, move, size, borderMode=cv2.BORDER_REPLICATE)
    return plain, max(plain, detail.measure(shifted))


class _Detail:
    """The detail of a photograph, with which renders are compared.

    Args:
        truth: (H, W) float32 brightness of the photograph.
        mask: (H, W) bool; True where pixels count.
    """

    def __init__(self, truth: np.ndarray, mask: np.ndarray) -> None:
        factor = min(1.0, _SIDE / max(mask.shape))
        self._size = tuple(max(1, round(side * factor)) for side in mask.shape[::-1])
        self._weight = self._resize(mask.astype(np.float32))
        self._coarse = max(_COARSE_PX, _COARSE * max(self._size))
        self._weights_nearby = _average(self._weight, self._coarse)
        self._truth = self._flatten(truth)
        self._mean, self._variance = _measure_contrast(self._truth)
        counts = _average(self._weight) > 1 - 1e-3
        detail = counts & (self._variance > _CONTRAST**2)
        chosen = (each for each in (detail, counts) if each.any())
        self._chosen = next(chosen, np.ones_like(counts))

    def measure(self, shown: np.ndarray) -> float:
        """Measures the share that a render's brightness (H, W) shows, see `measure_detail`."""
        shown = self._flatten(shown)
        mean, variance = _measure_contrast(shown)
        covariance = _average(self._truth * shown) - self._mean * mean
        least = _CONTRAST**2
        right = (2 * covariance + least) / (self._variance + variance + least) > _RIGHT
        return float(right[self._chosen].mean())

    def _flatten(self, picture: np.ndarray) -> np.ndarray:
        """Takes the mean of the surroundings inside the mask away."""
        inside = self._resize(picture) * self._weight
        level = _average(inside, self._coarse) / np.maximum(self._weights_nearby, _FEW_WEIGHTS)
        return inside - level * self._weight

    def _resize(self, picture: np.ndarray) -> np.ndarray:
        import cv2

        return cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)


def _average(values: np.ndarray, deviation: float = _WINDOW) -> np.ndarray:
    import cv2

    return cv2.GaussianBlur(values, (0, 0), deviation)


def _measure_contrast(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns mean and variance in the window around each pixel."""
    mean = _average(picture)
    return mean, _average(picture * picture) - mean * mean


def _average_photograph(photograph: np.ndarray) -> np.ndarray:
    return _average_channels(photograph.astype(np.float32) / np.float32(255))


def _average_channels(image: np.ndarray) -> np.ndarray:
    """Returns the mean of red, green and blue (H, W) as float32."""
    red, green, blue = np.moveaxis(np.asarray(image, np.float32), 2, 0)
    return (red + green + blue) / np.float32(3)
