"""What a user is told of recordings that were read, before anything is made of them."""

from typing import TYPE_CHECKING

from dvf_ig.cli.shell import warn

if TYPE_CHECKING:
    from dvf_ig.intake.problem import Use
    from dvf_ig.intake.read import SessionRecordings


def require_agreement(recordings: "SessionRecordings", use: "Use") -> "SessionRecordings":
    """The same recordings; a note is printed for whatever is doubtful about them.

    Raises:
        DvfIgError: the first reason why they cannot be used, or not together.
    """
    from dvf_ig.intake.fit import require_fit

    for found in require_fit(recordings, use):
        warn(f"{found.key}: {found.sentence}")
    return recordings
