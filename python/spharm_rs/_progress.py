"""Shows the progress of long computations."""

from __future__ import annotations

from typing import Any, Callable, Optional, Union

#: Called as ``progress(stage, done, total)``; ``total`` is 0 if it is unknown.
Callback = Callable[[str, int, int], Any]
Progress = Optional[Union[bool, Callback]]


def callback(progress: Progress) -> Callback | None:
    """Returns the function to call, or None: the caller's own function, or a tqdm bar for ``True``."""
    if progress is None or progress is False:
        return None
    if progress is True:
        return _Bar()
    if not callable(progress):
        raise ValueError(f"progress: expected True or a function of (stage, done, total), found {progress!r}")
    return progress


class _Bar:
    """Shows a tqdm bar for each stage."""

    def __init__(self) -> None:
        from tqdm.auto import tqdm

        self._tqdm = tqdm
        self._stage: str | None = None
        self._bar: Any = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage != self._stage:
            if self._bar is not None:
                self._bar.close()
            self._stage, self._bar = stage, self._tqdm(desc=stage, total=total or None, leave=False)
        self._bar.n = done
        self._bar.refresh()
        if total and done >= total:
            self._bar.close()
            self._stage = None
