"""How a photograph came to be: exposure, white balance, falloff of the lens, passers-by."""

from gsut.training.photograph.cut_out import CutOut
from gsut.training.photograph.movers import Movers
from gsut.training.photograph.outliers import Outliers
from gsut.training.photograph.photograph_model import PhotographModel
