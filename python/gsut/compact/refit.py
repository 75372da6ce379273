"""After merging: fits base colours to renders of the whole model through the training lenses."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from gsut.compact.scores import Passes, SeenView, require_views
from gsut.gaussians import SH_C0, Gaussians

# Pixels of blend weight that favour the present colour. Without them, what is hardly seen, behind
# others or in a hole, would take any colour for a small gain; views between the training views are
# nearly the same from 0.3 to 10.
_DAMPING = 1.0


def refit_colors(
    small: Gaussians,
    whole: Gaussians,
    views: Sequence[SeenView],
    rounds: int = 2,
    on_view: Callable[[], object] = lambda: None,
) -> Gaussians:
    """Moves base colours towards those with which `small` looks like `whole`; no photograph.

    A picture is linear in the colours. Each round adds to each Gaussian's colour the mean of the
    difference that is left, over the pixels by its blend weight there times the alpha of the
    pixel, damped: simultaneous algebraic reconstruction, which lowers a weighted squared error.
    Places, shapes, opacities and higher harmonics stay.

    Args:
        small: n Gaussians.
        whole: what they stand for.
        views: at least one.
        rounds: more are better and slower; the second brings a fifth of what the first does, the
            third hardly anything.
        on_view: called after each view of each round.

    Returns:
        `small` with other base colours. The same bits on any number of threads.

    Source: Andersen and Kak, "Simultaneous algebraic reconstruction technique", Ultrasonic Imaging
        1984.
    """
    made = small.to_dtype(np.float32).copy()
    target, seen = Passes(whole), np.zeros((len(made), 3))
    for turn in range(rounds):
        passes, change = Passes(made), np.zeros((len(made), 3))
        for view in require_views(views):
            wanted, _ = target.render(view, keep=False)
            found, alpha = passes.render(view)
            mask = view.mask[..., None].astype(np.float32)
            change += passes.backpropagate((wanted - found) * mask).sh[:, 0]
            if turn == 0:  # does not depend on the colours
                weights = np.repeat(alpha[..., None] * mask, 3, axis=2)
                seen += passes.backpropagate(weights).sh[:, 0]
            on_view()
        made.sh[:, 0] += (change / (SH_C0 * (seen + SH_C0 * _DAMPING))).astype(np.float32)
    return made
