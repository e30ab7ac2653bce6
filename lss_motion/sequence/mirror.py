"""A sequence with left and right exchanged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Literal

    from lss_motion.sequence.model import Sequence

    Images = Mapping[str, tuple[str, Literal[1, -1]]]


def mirrored(sequence: Sequence, images: Images) -> Sequence:
    """Return the sequence as seen in a mirror; joints without an image stay as they are.

    `images` gives for a joint the one on the other side and the sign of the angle there.
    """
    return replace(
        sequence,
        keyframes=tuple(
            replace(frame, deg=_exchanged(frame.deg, images)) for frame in sequence.keyframes
        ),
        tracks=tuple(mirrored(track, images) for track in sequence.tracks),
        play=tuple(
            replace(step, sequence=step.sequence and mirrored(step.sequence, images))
            for step in sequence.play
        ),
        layers=tuple(
            replace(
                layer,
                sequence=mirrored(layer.sequence, images),
                joints=tuple(images.get(name, (name, 1))[0] for name in layer.joints),
            )
            for layer in sequence.layers
        ),
    )


def _exchanged(angles_deg: Mapping[str, float], images: Images) -> dict[str, float]:
    exchanged = {}
    for name, angle_deg in angles_deg.items():
        image, sign = images.get(name, (name, 1))
        exchanged[image] = angle_deg if sign == 1 else -angle_deg
    return exchanged
