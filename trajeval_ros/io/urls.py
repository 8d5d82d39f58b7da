"""URLs of sources: what they must not hold."""

from __future__ import annotations

from trajeval_ros.exceptions import InputError


def require_no_password(url: str) -> None:
    """Refuse a URL with a password, which results, tables and logs would repeat.

    Raises:
        InputError: It has one; the message doesn't repeat it.
    """
    scheme, _, rest = url.partition("://")
    user, at, host = rest.partition("/")[0].rpartition("@")
    if at and ":" in user and scheme.lower() != "github":  # there it is OWNER:REPOSITORY@BRANCH
        raise InputError(
            f"{scheme}://{host} has a password, which results and logs repeat; set the password "
            "in the environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        )
