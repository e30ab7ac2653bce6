"""`lss-play` and `lss-motion`: arguments in, text and exit codes out; nothing heavy at import."""
