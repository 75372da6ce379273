"""A camera's way from light to a file: falloff, exposure, noise, tone, sharpening, compression."""

from __future__ import annotations

import dataclasses
import io
import math

import cv2
import numpy as np

from lab.demo_tracer.texture import to_srgb

_EARTH = 6_371_000.0  # radius in metres
_LATITUDE, _LONGITUDE = 48.1, 11.6  # of the world's origin, degrees


@dataclasses.dataclass(frozen=True)
class Sensor:
    """What a camera does to light.

    Args:
        falloff: share of the light lost in the corners.
        drift: of the exposure, the amplitude of its slow change; 0: manual.
        steps: largest jump of an automatic exposure, stops; 0: none.
        tint: amplitude of the white balance's change.
        shot_noise: variance over the light, of light in [0, 1]. read_noise: standard deviation.
        sharpening: amount of an unsharp mask.
        contrast: of the tone curve, from 0, none, to 1: it darkens what is dark.
        defocus: standard deviation of the blur of a lens out of focus, pixels.
        quality: of JPEG, 60 to 98; 0: PNG. crf: of H.264 for films.
    """

    falloff: float = 0.0
    drift: float = 0.0
    steps: float = 0.0
    tint: float = 0.0
    shot_noise: float = 0.0
    read_noise: float = 0.0
    sharpening: float = 0.0
    contrast: float = 0.0
    defocus: float = 0.0
    quality: int = 0
    crf: int = 22

    def find_gains(self, count: int, seed: int) -> np.ndarray:
        """Returns (count, 3): what each picture's light is multiplied by."""
        rng = np.random.default_rng([seed, 21])
        phase, period = rng.uniform(0, 2 * math.pi, 2), rng.uniform(0.5, 1.5) * max(count, 2)
        wave = 2 * math.pi * np.arange(count) / period
        gains = 1 + self.drift * np.sin(wave + phase[0])
        jumps = rng.uniform(-1, 1, count) * (rng.random(count) < 0.15) * self.steps
        gains = gains * 2.0 ** np.clip(np.cumsum(jumps), -1, 1)
        return gains[:, None] * (1 + self.tint * np.sin(0.5 * wave[:, None] + [0, 1, 2]))

    def spread_falloff(self, height: int, width: int) -> np.ndarray:
        """Returns (H, W, 1): the share of the light that reaches each pixel."""
        y, x = np.indices((height, width))
        square = (x + 0.5 - width / 2) ** 2 + (y + 0.5 - height / 2) ** 2
        return (1 - self.falloff * square / (0.25 * (width**2 + height**2)))[..., None]

    def develop(self, light: np.ndarray, rng: np.random.Generator | None) -> np.ndarray:
        """Makes display values uint8 RGB of light (H, W, 3).

        Without a generator there is no noise.
        """
        if self.defocus:
            light = cv2.GaussianBlur(light, (0, 0), self.defocus)
        if rng is not None:
            sigma = np.sqrt(self.shot_noise * np.clip(light, 0, 1.5) + self.read_noise**2)
            light = light + sigma * rng.standard_normal(light.shape)
        shown = to_srgb(1 - np.exp(-np.maximum(light, 0)))
        shown = shown + self.contrast * (shown * shown * (3 - 2 * shown) - shown)
        if self.sharpening:
            soft = cv2.GaussianBlur(shown, (0, 0), 1.0)
            shown = shown + self.sharpening * (shown - soft)
        return np.round(255 * np.clip(shown, 0, 1)).astype(np.uint8)


def draw_sensor(rng: np.random.Generator, seed: int) -> Sensor:
    """Draws a camera's faults; tone curve and focus from the seed alone."""
    noise = 10.0 ** rng.uniform(-5, -2.7)
    own = np.random.default_rng([seed, 61])
    return Sensor(
        falloff=float(rng.choice([0.0, 0.2, 0.4])),
        drift=float(rng.choice([0.0, 0.0, 0.03, 0.1, 0.3], p=[0.25, 0.25, 0.25, 0.15, 0.10])),
        steps=float(rng.choice([0.0, 0.5], p=[0.85, 0.15])),
        tint=float(rng.choice([0.0, 0.02])),
        shot_noise=noise,
        read_noise=0.3 * math.sqrt(noise) * rng.uniform(0.1, 0.5),
        sharpening=float(rng.choice([0.0, 0.0, 0.5])),
        quality=int(rng.choice([0, 60, 75, 88, 95, 98])),
        crf=int(rng.integers(18, 33)),
        contrast=float(own.uniform(0.3, 1.0)),
        defocus=float(own.choice([0.0, 0.5, 1.0], p=[0.7, 0.2, 0.1])),
    )


def measure_exposure(light: np.ndarray) -> float:
    """Measures the gain that an automatic exposure gives a picture; the dark stays rather dark."""
    middle = float(np.exp(np.mean(np.log(np.maximum(light, 1e-4)))))
    return (0.25 / middle) ** 0.9


def encode_picture(
    image: np.ndarray,
    quality: int,
    exif: dict[str, float | str] | None,
    place: np.ndarray | None = None,
    turned: bool = False,
) -> bytes:
    """Encodes RGB as JPEG of this quality, with metadata, or as PNG where quality is 0.

    Args:
        image: (H, W, 3) uint8.
        quality: of JPEG.
        exif: make, model and focal_35mm; None: none.
        place: (3,) metres east, north and up that EXIF states; None: nowhere.
        turned: whether the pixels of a JPEG lie on their side, with the flag that says so.
    """
    from PIL import Image

    out = io.BytesIO()
    picture = Image.fromarray(image)
    if quality == 0:
        picture.save(out, "PNG")
        return out.getvalue()
    facts = Image.Exif()
    if exif:
        facts[0x010F], facts[0x0110] = str(exif["make"]), str(exif["model"])
        details = facts.get_ifd(0x8769)
        details[0xA405] = round(float(exif["focal_35mm"]))
    if place is not None:
        facts.get_ifd(0x8825).update(_describe_place(place))
    if turned:  # the camera was held upright: pixels lie on their side, and a flag says so
        picture = picture.transpose(Image.Transpose.ROTATE_90)
        facts[0x0112] = 6
    picture.save(out, "JPEG", quality=quality, exif=facts)
    return out.getvalue()


def _describe_place(metres: np.ndarray) -> dict[int, object]:
    """Describes a place east, north and above a point of the Earth, as EXIF's GPS directory."""
    north = _LATITUDE + math.degrees(metres[1] / _EARTH)
    east = _LONGITUDE + math.degrees(metres[0] / (_EARTH * math.cos(math.radians(_LATITUDE))))

    def split(degrees: float) -> tuple[float, float, float]:
        minutes = 60 * (degrees - int(degrees))
        return float(int(degrees)), float(int(minutes)), 60 * (minutes - int(minutes))

    return {1: "N", 2: split(north), 3: "E", 4: split(east), 5: 0, 6: 100.0 + float(metres[2])}
