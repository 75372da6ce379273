"""The gyroscope of a film's camera as evidence: calibrated by the pictures, then beside them."""

from gsut.sfm.gyroscope.calibration import calibrate_turns
from gsut.sfm.gyroscope.evidence import USUAL_READOUT, sharpen_rates, use_gyroscope
from gsut.sfm.gyroscope.focal import find_focal_by_turns
from gsut.sfm.gyroscope.structures import correct_by_turns
