"""The errors that a user can mend.

Every message is one sentence that says what is wrong, where, and how to mend it. The command
line prints it alone and exits with status 2; a traceback always means a defect of ours.
"""


class TrajevalError(Exception):
    """Base of all errors that this package raises on purpose."""


class InputError(TrajevalError):
    """A file, bag, topic or trajectory that can't be used as it is."""


class SettingsError(TrajevalError):
    """Settings that contradict each other, or a value outside of what is possible."""


class DegenerateGeometryError(TrajevalError):
    """The states don't determine the alignment that the gauge asks for."""


class NoMatchError(InputError):
    """No pose of the estimate has a groundtruth to be compared with."""
