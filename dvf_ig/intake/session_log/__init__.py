"""The log of a session: its document, its topics, the heart attached to it, and the record of a live one."""
