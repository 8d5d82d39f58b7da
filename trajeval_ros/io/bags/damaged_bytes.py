"""The error of readers that find other bytes than the format requires."""


class DamagedError(Exception):
    """Bytes are not what the format requires; the message describes the difference."""
