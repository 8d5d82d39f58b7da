"""Check of the URLs of sources."""

from __future__ import annotations

from trajeval_ros.exceptions import InputError


def require_no_password(url: str) -> None:
    """Check that a URL has no password, since results, tables and logs repeat the URL.

    Raises:
        InputError: The URL has a password. The message does not repeat it.
    """
    scheme, _, rest = url.partition("://")
    user, at, host = rest.partition("/")[0].rpartition("@")
    if at and ":" in user and scheme.lower() != "github":  # its form is OWNER:REPOSITORY@BRANCH
        raise InputError(
            f"{scheme}://{host} has a password, which results and logs repeat; set the password "
            "in the environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        )
