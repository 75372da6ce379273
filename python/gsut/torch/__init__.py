"""gsut for PyTorch, optional: gsplat's `rasterization` on a CPU, through any lens.

Needs torch, any build of it (`pip install gsut[torch]` brings one). Nothing else in gsut imports
this folder.
"""

from gsut.torch.patch import patch_gsplat
from gsut.torch.rasterization import rasterization
from gsut.torch.views import View, render_view

__all__ = ["View", "patch_gsplat", "rasterization", "render_view"]
