"""Measures how much of a photograph's detail a render shows in the right place.

PSNR falls with fog in a sky and with brightness as much as with blur. The contrast and structure
term of SSIM (Wang et al., 2004) compares what an eye calls sharp: local contrast, not its level.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gsut.judge.checks import MOVING

# Longer side in pixels at which pictures are compared: that of a picture on a page.
SIDE = 800
# Standard deviation in pixels of the window in which contrast is measured, as in SSIM.
_WINDOW = 1.5
# Contrast, of full scale, below which a place shows no detail: SSIM's constant K2.
_CONTRAST = 0.03
# Standard deviation, of the longer side, of the window whose mean is taken away: a blur counts by
# its share of the picture, so that it is seen in a small one, too.
_COARSE = 0.01
# Contrast-structure term above which a detail is right: half of a perfect one.
_RIGHT = 0.5
# Share of the photograph's contrast, a darker picture apart, below which a detail is veiled:
# between fog that hides little (0.7) and a ghost (0.5).
_VEILED = 0.55
# Standard deviation, of `_COARSE`, of the window in which that is measured: a blur leaves it.
_WIDE = 4.0
_CELLS = 20  # along a picture's longer side, in which detail is counted to find a wrong patch
_FEW_DETAILS = 0.1  # share of such pixels that must have contrast
_FAR_BELOW = 0.35  # by which a wrong cell shows less of its detail than the whole picture


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
) -> tuple[float, float, np.ndarray, float]:
    """Measures the detail that is right, also after a shift, and the largest patch that is wrong.

    Where a pose or a lens is wrong, a shift brings detail back; blur, holes and what moved it does
    not mend.

    Args:
        photograph, image, mask: see `measure_detail`.

    Returns:
        The result of `measure_detail`; the detail of the render shifted by what phase correlation
        finds, the first again if that is more; (h, w) bool at the size at which detail is
        compared, the largest connected patch in which far less detail is right than in the whole
        picture, all False if there is none; and the result of `measure_detail` outside it.
    """
    import cv2

    truth, shown = _average_photograph(photograph), _average_channels(image)
    detail = _Detail(truth, mask)
    plain = detail.measure(shown)
    where = detail.find_wrong_patch(shown)
    patch = where, detail.measure(shown, ~where)
    if min(mask.shape) == 1:  # no window falls to nothing along a single line
        return plain, plain, *patch
    right, down = detail.find_shift(shown)
    move = np.array([[1, 0, right], [0, 1, down]], np.float32)
    size = mask.shape[1], mask.shape[0]
    shifted = cv2.warpAffine(shown, move, size, borderMode=cv2.BORDER_REPLICATE)
    return plain, max(plain, detail.measure(shifted)), *patch


def is_beside(patch: np.ndarray, where: np.ndarray | None) -> bool:
    """Returns whether a wrong patch (h, w), or a cell beside it, has a pixel of `where` (H, W)."""
    import cv2

    if where is None or not patch.any():
        return False
    width = 2 * _choose_cell(patch.shape) + 1
    around = cv2.dilate(patch.astype(np.uint8), np.ones((width, width), np.uint8))
    size = patch.shape[1], patch.shape[0]
    inside = cv2.resize(where.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return bool((inside * around).any())


class _Detail:
    """The detail of a photograph, with which renders are compared.

    Args:
        truth: (H, W) float32 brightness of the photograph.
        mask: (H, W) bool; True where pixels count.
    """

    def __init__(self, truth: np.ndarray, mask: np.ndarray) -> None:
        factor = min(1.0, SIDE / max(mask.shape))
        self._size = tuple(max(1, round(side * factor)) for side in mask.shape[::-1])
        self._weight = self._resize(mask.astype(np.float32))
        self._coarse = max(1.0, _COARSE * max(self._size))  # a pixel at least
        self._truth = self._flatten(truth)
        self._bright = self._resize(truth)
        self._mean, self._variance = _measure_contrast(self._truth)
        counts = _average(self._weight) > 1 - 1e-3
        detail = counts & (self._variance > _CONTRAST**2)
        chosen = (each for each in (detail, counts) if each.any())
        self.chosen = next(chosen, np.ones_like(counts))

    def find_right(self, shown: np.ndarray) -> np.ndarray:
        """Finds (h, w) where a render's brightness (H, W) shows what the photograph does."""
        is_clear = self._compare_contrast(self._resize(shown))
        shown = self._flatten(shown)
        mean, variance = _measure_contrast(shown)
        covariance = _average(self._truth * shown) - self._mean * mean
        least = _CONTRAST**2
        term = (2 * covariance + least) / (self._variance + variance + least)
        return is_clear & (term > _RIGHT)

    def measure(self, shown: np.ndarray, where: np.ndarray | bool = True) -> float:
        """Measures the share that a render's brightness (H, W) shows, see `measure_detail`.

        where: (h, w) of the pixels that count, as those that `find_right` returns.
        """
        chosen = self.chosen & where
        return float(self.find_right(shown)[chosen].mean()) if chosen.any() else 0.0

    def find_shift(self, shown: np.ndarray) -> tuple[float, float]:
        """Finds the shift in pixels, right and down, of a render's brightness (H, W)."""
        import cv2

        window = cv2.createHanningWindow(self._size, cv2.CV_32F)
        truth = self._truth.copy()  # what is compared is multiplied by the window in its place
        shift, _ = cv2.phaseCorrelate(self._flatten(shown), truth, window)
        right, down = (
            each * side / small
            for each, side, small in zip(shift, shown.shape[::-1], self._size, strict=True)
        )
        return right, down

    def find_wrong_patch(self, shown: np.ndarray) -> np.ndarray:
        """Finds (h, w) of the largest wrong patch of a render's brightness (H, W)."""
        import cv2

        right, chosen = self.find_right(shown) & self.chosen, self.chosen
        side = _choose_cell(chosen.shape)

        def count(pixels: np.ndarray) -> np.ndarray:
            """Counts the pixels in each cell and its neighbours."""
            places = (np.arange(0, length, side) for length in pixels.shape)
            cells = pixels.astype(np.float64)
            for axis, starts in enumerate(places):
                cells = np.add.reduceat(cells, starts, axis)
            return cv2.boxFilter(cells, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)

        details = count(chosen)
        is_wrong = count(right) < (right.sum() / chosen.sum() - _FAR_BELOW) * details
        is_wrong &= details > _FEW_DETAILS * count(np.ones_like(chosen))
        _, labels, areas, _ = cv2.connectedComponentsWithStats(
            is_wrong.astype(np.uint8), connectivity=4
        )
        counts = areas[1:, cv2.CC_STAT_AREA]
        if counts.max(initial=0) < MOVING * is_wrong.size:  # no single cell
            return np.zeros_like(chosen)
        wrong = np.kron(labels == 1 + np.argmax(counts), np.ones((side, side), bool))
        return wrong[: chosen.shape[0], : chosen.shape[1]]

    def _compare_contrast(self, shown: np.ndarray) -> np.ndarray:
        """Finds (h, w) where brightness varies as in the photograph, by its share of the whole.

        Wider surroundings than those of the structure: a blur keeps the contrast of these.
        """
        inside = self._weight > 0
        level = 1 / 255  # of grey
        brightness = np.median(shown[inside]) / max(float(np.median(self._bright[inside])), level)
        brightness = min(1.0, float(brightness))
        width = _WIDE * self._coarse
        covariance, variance = (
            self._average_inside(self._bright * other, width)
            - self._average_inside(self._bright, width) * self._average_inside(other, width)
            for other in (shown, self._bright)
        )
        return covariance + level**2 > _VEILED * brightness * variance

    def _average_inside(self, picture: np.ndarray, deviation: float) -> np.ndarray:
        """Averages the surroundings (h, w) inside the mask."""
        weights = np.maximum(_average(self._weight, deviation), np.finfo(np.float32).eps)
        return _average(picture * self._weight, deviation) / weights

    def _flatten(self, picture: np.ndarray) -> np.ndarray:
        """Takes the mean of the surroundings inside the mask away."""
        small = self._resize(picture)
        return (small - self._average_inside(small, self._coarse)) * self._weight

    def _resize(self, picture: np.ndarray) -> np.ndarray:
        import cv2

        return cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)


def _choose_cell(shape: Sequence[int]) -> int:
    """Chooses the side in pixels of the cells in which detail is counted."""
    return -(-max(shape) // _CELLS)


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
