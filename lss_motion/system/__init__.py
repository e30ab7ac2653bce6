"""What the operating system gives: waiting, processes of this package, messages between them.

| file          | what it is                                       | who calls it               |
|---------------|--------------------------------------------------|----------------------------|
| `messages.py` | a pipe of messages: framing, bounds, decoding    | both ends of a helper      |
| `process.py`  | starts a module in a process of its own; its end | who needs a helper         |
| `reactor.py`  | the one call that waits; a helper's loop         | clocks, helpers, `process` |
"""
