"""The exceptions and warnings of RTGI.

Errors are raised only by orchestration code, in one line that names what was wrong and the mend. Kernels never raise.
"""


class RtgiError(Exception):
    """Base of every error that RTGI raises on purpose; its text is one line for the user."""


class InputError(RtgiError, ValueError):
    """The caller's words, file, array or setting cannot be used."""


class CaptureError(RtgiError, RuntimeError):
    """Blender could not deliver what a frame needs."""


class Cancelled(RtgiError):
    """The user pressed Esc; whoever catches it leaves no trace of the unfinished frame."""
