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
    import cv2

    factor = min(1.0, _SIDE / max(mask.shape))
    size = max(1, round(mask.shape[1] * factor)), max(1, round(mask.shape[0] * factor))
    pictures = (photograph.astype(np.float32) / np.float32(255), image.astype(np.float32))
    truth, shown, weight = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA)
        for each in (*(picture.mean(axis=2) for picture in pictures), mask.astype(np.float32))
    )

    def average(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values, (0, 0), _WINDOW)

    means = average(truth), average(shown)
    variances = [average(x * x) - m * m for x, m in zip((truth, shown), means, strict=True)]
    covariance = average(truth * shown) - means[0] * means[1]
    least = _CONTRAST**2
    right = (2 * covariance + least) / (variances[0] + variances[1] + least) > _RIGHT
    counts = average(weight) > 1 - 1e-3
    detail = counts & (variances[0] > least)
    chosen = next((each for each in (detail, counts) if each.any()), np.ones_like(counts))
    return float(right[chosen].mean())


def measure_shifted_detail(photograph: np.ndarray, image: np.ndarray, mask: np.ndarray) -> float:
    """Measures the detail that is right after the render is shifted as a whole.

    Where a pose or a lens is wrong, a shift brings detail back; blur, holes and what moved it does
    not mend.

    Args:
        photograph, image, mask: see `measure_detail`.

    Returns:
        The detail of the render shifted by what phase correlation finds, or of the render as it is
        if that is more.
    """
    import cv2

    if min(mask.shape) < _SMALLEST:
        return measure_detail(photograph, image, mask)
    weight = mask.astype(np.float32)
    shown = np.ascontiguousarray(image, np.float32)

    def flatten(picture: np.ndarray) -> np.ndarray:
        grey = picture.mean(axis=2, dtype=np.float32) * weight
        return grey - cv2.GaussianBlur(grey, (0, 0), _LEVEL)

    size = mask.shape[1], mask.shape[0]
    pictures = (shown, photograph.astype(np.float32) / np.float32(255))
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    rendered, photographed = map(flatten, pictures)
    (right, down), _ = cv2.phaseCorrelate(rendered, photographed, window)
    move = np.array([[1, 0, right], [0, 1, down]], np.float32)
    shifted = cv2.warpAffine(shown, move, size, borderMode=cv2.BORDER_REPLICATE)
    return max(measure_detail(photograph, each, mask) for each in (shown, shifted))
