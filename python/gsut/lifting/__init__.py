"""Lifting: what pixels of many views say, such as labels, becomes a property of the Gaussians."""

from gsut.lifting.back_projection import lift
from gsut.lifting.judge import judge_lifted
from gsut.lifting.lifted import Lifted
from gsut.lifting.map_folder import MapFolder
