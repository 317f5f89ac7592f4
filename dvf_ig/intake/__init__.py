"""From a lab's files to a session: its parts, whether they agree, its calibrations, its start, its log."""
