"""Progress on standard error: one bar a stage, with its state in words and the time left."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import Any, TextIO, TypeVar

from gsut.terminal import TerminalStream

# Seconds between refreshes: often on a terminal, seldom in a log file.
_TERMINAL_INTERVAL = 0.1
_LOG_INTERVAL = 15.0
# Seconds after which a stage is reported in a log: what ends before needs no report.
_LOG_DELAY = 10.0
# The time left comes from the pace of the last steps, which grow slower as Gaussians are added.
_SMOOTHING = 0.1
_COUNTS = "{n_fmt}/{total_fmt}, {remaining} left, {rate_fmt}"
_FORMAT = "{desc:<9}{percentage:3.0f}% {bar:20} " + _COUNTS + "{postfix}"
_TIMED_FORMAT = "{desc:<9}{percentage:3.0f}% {bar:20} {n_fmt}/{total_fmt}{postfix}"
SHARES = 1000  # parts of a bar of shares
_SHARE_FORMAT = "{percentage:3.0f}% {bar:20} {elapsed}{postfix}"
_Item = TypeVar("_Item")


class _Log:
    """A file that is no terminal: a bar's states become lines of their own."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def write(self, text: str) -> None:
        if words := text.strip("\r\n "):
            self._file.write(words + "\n")

    def flush(self) -> None:
        self._file.flush()


class Progress:
    """Bars, one after the other; lines in a log, where the file is no terminal.

    Args:
        enabled: False shows nothing and costs nothing.
        file: where to write; standard error if None.
    """

    def __init__(self, enabled: bool = True, file: TextIO | None = None) -> None:
        self._enabled = enabled
        self._file = None if file is None else TerminalStream(file)
        self._bar: Any = None
        self._stage = ""
        self._psnr: float | None = None

    def show(
        self, stage: str, done: int, total: int, text: str = "", left: float | None = None
    ) -> None:
        """Moves the stage's bar; a new stage begins a new one.

        Args:
            stage: a word.
            done: how much of it is done.
            total: the whole; 0 shows nothing.
            text: the state, shown behind the bar.
            left: seconds, where they are known otherwise than by the pace of the last steps.
        """
        if not self._enabled or total == 0:
            return
        from tqdm import tqdm

        if stage != self._stage or self._bar is None or done < self._bar.n:
            self.close()
            self._stage = stage
            self._bar = self._start_bar(
                total=total, initial=max(done - 1, 0), desc=stage, smoothing=_SMOOTHING,
                bar_format=_FORMAT if left is None else _TIMED_FORMAT, log_delay=_LOG_DELAY,
            )  # fmt: skip
        if left is not None:
            text = f"about {tqdm.format_interval(left)} left, {text}"
        self._bar.set_postfix_str(text, refresh=False)
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def _start_bar(self, log_delay: float = 0.0, **settings: Any) -> Any:
        from tqdm import tqdm

        file = self._find_file()
        terminal = file.isatty()
        interval = _TERMINAL_INTERVAL if terminal else _LOG_INTERVAL
        return tqdm(
            file=file if terminal else _Log(file), dynamic_ncols=terminal, mininterval=interval,
            maxinterval=interval, delay=0.0 if terminal else log_delay, **settings,
        )  # fmt: skip

    def show_share(self, share: float, seconds_left: float, text: str) -> None:
        """Moves the one bar of a command whose time left is known otherwise than by its pace.

        Args:
            share: of the whole, 0 to 1.
            seconds_left: of the whole.
            text: the state, shown behind the bar.
        """
        if not self._enabled:
            return
        from tqdm import tqdm

        if self._bar is None:
            self._bar = self._start_bar(total=SHARES, bar_format=_SHARE_FORMAT, miniters=0)
        left = tqdm.format_interval(seconds_left)
        self._bar.set_postfix_str(f"about {left} left, {text}", refresh=False)
        self._bar.update(int(share * SHARES) - self._bar.n)

    def show_step(
        self,
        step: int,
        total: int,
        loss: float,
        num_gaussians: int,
        psnr: float | None = None,
        left: float | None = None,
    ) -> None:
        """Shows the state of a training.

        Args:
            step: number of steps done, counted from the run's beginning.
            total: number of steps of the whole run.
            loss: loss of the last step.
            num_gaussians: number of Gaussians now.
            psnr: held-out PSNR in dB where it has just been measured; the last one stays shown.
            left: seconds, see `show`.
        """
        if not self._enabled:
            return
        self._psnr = self._psnr if psnr is None else psnr
        text = f"loss {loss:.4f}, {num_gaussians:,} Gaussians"
        if self._psnr is not None:
            text += f", PSNR {self._psnr:.2f} dB"
        self.show("training", step, total, text, left)

    def iterate(self, stage: str, items: Sequence[_Item]) -> Iterator[_Item]:
        """Yields the items, with a bar of the number done."""
        for done, item in enumerate(items):
            self.show(stage, done, len(items))
            yield item
        self.show(stage, len(items), len(items))
        self.close()

    def note(self, text: str) -> None:
        """Prints a line above the bar."""
        if self._enabled:
            from tqdm import tqdm

            tqdm.write(f"note: {' '.join(text.splitlines())}", file=self._find_file())

    def _find_file(self) -> Any:
        self._file = self._file or TerminalStream(sys.stderr)
        return self._file

    def close(self) -> None:
        """Leaves the last state standing on its own line."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
