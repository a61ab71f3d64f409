"""tqdm's progress bar, which an error takes away: no dead bar above the sentence that says what is wrong."""

from __future__ import annotations

import tqdm as library


class tqdm(library.tqdm):
    """A progress bar that stays after its end, but not after an error."""

    def __exit__(self, kind, error, trace) -> None:
        """Close the bar; wipe it when an error ends the block."""
        if kind is not None:
            self.leave = False
        super().__exit__(kind, error, trace)
