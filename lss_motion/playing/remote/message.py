"""What all messages of `schema` are made of."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

LABEL_MAX_CHARS: Final = 64
Name = Annotated[str, Field(min_length=1, max_length=LABEL_MAX_CHARS)]


class Message(BaseModel):
    """Base of all messages: no unknown keys, no text for numbers, no NaN."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class Operation(Message):
    """Base of all operations. `id` comes back in the event `accepted` or `refused`."""

    id: Annotated[int, Field(ge=0)] = 0
