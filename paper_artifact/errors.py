"""The one exception the artifact raises for input it cannot work with."""

from __future__ import annotations


class InputError(ValueError):
    """Bad input. The message is one sentence that names the input and says what to do.

    The command line prints it without a trace and exits with code 1.
    """
