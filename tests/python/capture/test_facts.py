"""What a camera wrote about a photograph: focal length, place, view, and hostile values."""

import math
import struct

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from gsut.capture.exif import read_facts
from gsut.capture.focal import FocalStatement, find_focal_prior
from gsut.capture.photographs import collect_photographs

DIAGONAL_35 = math.hypot(36, 24)
XMP = """<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description
 drone-dji:GimbalRollDegree="{roll}" drone-dji:GimbalYawDegree="{yaw}"
 drone-dji:GimbalPitchDegree="{pitch}" /></x:xmpmeta>"""
DAMAGES = 300


def save_photograph(path, size=(64, 48), tags=(), details=(), place=(), xmp=None):
    """A JPEG with these EXIF tags of its three directories, and XMP."""
    exif = Image.Exif()
    exif.update(dict(tags))
    exif.get_ifd(0x8769).update(dict(details))
    exif.get_ifd(0x8825).update(dict(place))
    more = {} if xmp is None else {"xmp": xmp.encode()}
    Image.new("RGB", size, (90, 120, 150)).save(path, exif=exif, **more)
    return path


def find_prior(size, **stated):
    prior, notes = find_focal_prior(FocalStatement(**stated), *size)
    assert notes == []
    return prior


def test_focal_length_of_a_crop_refers_to_the_whole_sensor():
    # 16:9 of a 4:3 sensor of a phone: the diagonal is that of 4000 x 3000.
    prior = find_prior((4000, 2250), focal_mm=3.61, equivalent_mm=20)
    assert prior.px == pytest.approx(20 / DIAGONAL_35 * 5000)
    assert abs(math.log(20 / DIAGONAL_35 * math.hypot(4000, 2250) / prior.px)) < 2 * prior.sigma
    # 16:9 of a 3:2 sensor of APS-C.
    prior = find_prior((6000, 3375), focal_mm=20, equivalent_mm=30)
    assert prior.px == pytest.approx(30 / DIAGONAL_35 * math.hypot(6000, 4000))
    # A square of a full frame, stored upright.
    prior = find_prior((4000, 4000), focal_mm=50, equivalent_mm=50)
    assert prior.px == pytest.approx(50 / DIAGONAL_35 * math.hypot(6000, 4000))
    # Whole sensors need no crop and are narrower.
    assert find_prior((4000, 3000), focal_mm=4, equivalent_mm=26).sigma < 0.06


def test_focal_length_of_a_resized_photograph_is_scaled():
    whole = find_prior((4000, 3000), focal_mm=5, equivalent_mm=35)
    small = find_prior((1000, 750), focal_mm=5, equivalent_mm=35, original=(4000, 3000))
    upright = find_prior((750, 1000), focal_mm=5, equivalent_mm=35, original=(4000, 3000))
    assert small.px == pytest.approx(whole.px / 4) == upright.px
    cropped = find_prior((1000, 500), focal_mm=5, equivalent_mm=35, original=(4000, 3000))
    assert cropped.px == pytest.approx(whole.px / 4) and cropped.sigma > 0.1


def test_focal_length_by_the_sensors_pixels():
    prior = find_prior(
        (1500, 1000), focal_mm=20.0, pixels_per_mm=3000 / 22.5, original=(3000, 2000)
    )
    assert prior.px == pytest.approx(20 / 22.5 * 1500)
    zoomed = find_prior((3000, 2000), focal_mm=20.0, pixels_per_mm=3000 / 22.5, zoom=2.0)
    assert zoomed.px == pytest.approx(2 * 20 / 22.5 * 3000)


def test_focal_lengths_that_contradict_each_other_are_named():
    stated = FocalStatement(focal_mm=20.0, equivalent_mm=60.0, pixels_per_mm=3000 / 22.5)
    prior, (note,) = find_focal_prior(stated, 3000, 2000)
    assert "contradicts itself" in note and prior.sigma > 0.3
    prior, (note,) = find_focal_prior(FocalStatement(equivalent_mm=4000.0), 3000, 2000)
    assert prior is None and "of no lens" in note


def test_places_accuracy_and_heading_are_read(tmp_path):
    place = {1: "N", 2: (46.0, 50.0, 33.0), 3: "W", 4: (91.0, 59.0, 40.0), 5: b"\1", 6: 12.5,
             16: "T", 17: 271.5, 31: 4.0}  # fmt: skip
    facts = read_facts(save_photograph(tmp_path / "a.jpg", place=place))
    assert facts.place.to_values() == pytest.approx((46.8425, -91.994444, -12.5))
    assert (facts.place.accuracy, facts.heading) == (4.0, 271.5)


def test_gimbal_gives_up_and_heading(tmp_path):
    def read(**angles):
        return read_facts(save_photograph(tmp_path / "a.jpg", xmp=XMP.format(**angles)))

    down = read(roll="+0.00", yaw="-90.0", pitch="-90.00")
    assert down.heading == 270 and down.up == pytest.approx((0, 0, -1))
    level = read(roll="0", yaw="10", pitch="0")
    assert level.up == pytest.approx((0, -1, 0))
    clockwise = read(roll="90", yaw="0", pitch="0")
    assert clockwise.up == pytest.approx((-1, 0, 0))
    absurd = read(roll="1e9", yaw="9999", pitch="nan")
    assert absurd.up is None and absurd.heading is None


def test_absurd_values_are_absent(tmp_path):
    facts = read_facts(
        save_photograph(
            tmp_path / "a.jpg",
            tags={0x010F: "A\0\0" + "x" * 500, 0x0110: "\n\t\x07 Name", 0x0112: 77},
            details={
                0x9003: "0000:00:00 00:00:00", 0x920A: IFDRational(1, 0), 0xA405: 65535,
                0xA20E: IFDRational(0, 0), 0xA002: 0, 0xA003: 4_000_000_000, 0xA404: 0.0,
            },
            place={1: "N", 2: (IFDRational(91, 1), IFDRational(0, 1), IFDRational(0, 1)), 3: "E",
                   4: (0.0, 0.0, 0.0), 6: 1e9},
        )
    )  # fmt: skip
    assert (facts.make, facts.model, facts.orientation) == ("A", "Name", 1)
    assert facts.focal is facts.time is facts.place is facts.original is facts.heading is None
    assert any("none on the earth" in note for note in facts.notes)


def test_position_of_no_fix_and_impossible_altitude(tmp_path):
    zero = {1: "N", 2: (0.0, 0.0, 0.0), 3: "E", 4: (0.0, 0.0, 0.0)}
    assert read_facts(save_photograph(tmp_path / "a.jpg", place=zero)).place is None
    high = {**zero, 2: (1.0, 0.0, 0.0), 6: 400_000.0}
    facts = read_facts(save_photograph(tmp_path / "b.jpg", place=high))
    assert facts.place.altitude == 0 and "altitude" in facts.notes[0]


def test_notes_of_many_photographs_are_one(tmp_path):
    (tmp_path / "p").mkdir()
    for i in range(5):
        save_photograph(tmp_path / f"p/{i}.jpg", details={0xA405: 4000})
    (note,) = collect_photographs([tmp_path / "p"], tmp_path / "out").notes
    assert "0.jpg" in note and "of no lens" in note


def test_damaged_metadata_never_harms(tmp_path):
    path = save_photograph(
        tmp_path / "a.jpg",
        tags={0x010F: "ACME", 0x0112: 6},
        details={0xA405: 35, 0x920A: 5.85, 0x9003: "2024:06:01 12:00:00", 0xA002: 64, 0xA003: 48},
        place={1: "N", 2: (46.0, 50.0, 33.0), 3: "W", 4: (91.0, 59.0, 40.0), 6: 12.5},
        xmp=XMP.format(roll="0", yaw="10", pitch="-45"),
    )
    whole = path.read_bytes()
    start = whole.index(b"Exif\0\0")
    (length,) = struct.unpack(">H", whole[start - 2 : start])
    rng = np.random.default_rng(0)
    for _ in range(DAMAGES):
        data = bytearray(whole)
        for at in rng.integers(start + 6, start + length - 2, 4):
            data[at] = rng.choice([0, 1, 2, 127, 128, 255])
        path.write_bytes(bytes(data))
        facts = read_facts(path)
        assert (facts.width, facts.height) == (64, 48)
        assert facts.focal is None or 0 < facts.focal.sigma < 10
        assert facts.place is None or np.isfinite(facts.place.to_values()).all()
