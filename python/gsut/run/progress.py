"""Progress bars on standard error: of training, and of the stages of other work."""

from __future__ import annotations

import sys
from typing import Any, TextIO

# Seconds between refreshes: often on a terminal, seldom in a log file.
_TERMINAL_INTERVAL = 0.1
_LOG_INTERVAL = 15.0
# The time left comes from the pace of the last steps, which grow slower as Gaussians are added.
_SMOOTHING = 0.1
_STAGE_BAR = "{desc:<9}{percentage:3.0f}% {bar:20} {n_fmt}/{total_fmt}, {remaining} left{postfix}"


class TrainingProgress:
    """Shows step, loss, number of Gaussians, PSNR and the time left on standard error.

    Args:
        total_steps: number of steps of the whole run.
        enabled: False shows nothing and costs nothing.
        first_step: steps already done by the run that is resumed.
        file: where to write; standard error if None.
    """

    def __init__(
        self,
        total_steps: int,
        enabled: bool = True,
        first_step: int = 0,
        file: TextIO | None = None,
    ) -> None:
        self._bar: Any = None
        self._psnr: float | None = None
        if not enabled:
            return
        from tqdm import tqdm

        file = file or sys.stderr
        interval = _TERMINAL_INTERVAL if file.isatty() else _LOG_INTERVAL
        self._bar = tqdm(
            total=total_steps,
            initial=first_step,
            unit="step",
            file=file,
            dynamic_ncols=True,
            mininterval=interval,
            maxinterval=interval,
            smoothing=_SMOOTHING,
            bar_format="{percentage:3.0f}% {bar} {n_fmt}/{total_fmt} steps, "
            "{remaining} left, {rate_fmt}{postfix}",
        )

    def update(self, step: int, loss: float, num_gaussians: int, psnr: float | None = None) -> None:
        """Shows the state after `step` steps.

        Args:
            step: number of steps done, counted from the run's beginning.
            loss: loss of the last step.
            num_gaussians: number of Gaussians now.
            psnr: held-out PSNR in dB where it has just been measured; the last one stays shown.
        """
        if self._bar is None:
            return
        if psnr is not None:
            self._psnr = psnr
        text = f"loss {loss:.4f}, {num_gaussians:,} Gaussians"
        if self._psnr is not None:
            text += f", PSNR {self._psnr:.2f} dB"
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.update(step - self._bar.n)

    def close(self) -> None:
        """Leaves the last state standing on its own line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> TrainingProgress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class StageBars:
    """One progress bar a stage, on standard error."""

    def __init__(self, enabled: bool) -> None:
        self._enabled = enabled
        self._bar: Any = None
        self._stage = ""

    def show(self, stage: str, done: int, total: int, text: str = "") -> None:
        """Moves the stage's bar; a new stage begins a new one."""
        if not self._enabled or total == 0:
            return
        from tqdm import tqdm

        if stage != self._stage or (self._bar is not None and done < self._bar.n):
            self.close()
            self._stage = stage
            interval = _TERMINAL_INTERVAL if sys.stderr.isatty() else _LOG_INTERVAL
            self._bar = tqdm(
                total=total, desc=stage, bar_format=_STAGE_BAR, dynamic_ncols=True,
                mininterval=interval, maxinterval=interval,
            )  # fmt: skip
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def note(self, text: str) -> None:
        """A line of words above the bar."""
        if self._enabled:
            from tqdm import tqdm

            tqdm.write(f"note: {text}", file=sys.stderr)

    def close(self) -> None:
        """Leaves the last state standing."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> StageBars:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
