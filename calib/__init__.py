"""From photographs of a chessboard to a lens file: the program behind `gsut calibrate`.

It uses gsut's public names and lens files only.
"""

from calib.calibrate import calibrate
from calib.job import Job
