"""The only side effects: clocks, ports, the one loop that waits, logs and reports."""
