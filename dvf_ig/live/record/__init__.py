"""The record of a live session: its log, written beside it."""

from .record import LOG, NO_RECORD, PART, Record, SessionRecord, session_record
from .work import CountedWork

__all__ = ["LOG", "NO_RECORD", "PART", "CountedWork", "Record", "SessionRecord", "session_record"]
