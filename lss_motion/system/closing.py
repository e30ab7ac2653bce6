"""What is open until `close` is called, as a context manager."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """A context manager that is itself what it opens; its end is `close`, whatever ended it."""

    @abstractmethod
    def close(self) -> None:
        """End it; another call changes nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
