"""Names of mouth shapes, of three kinds, and which of them mean the same mouth.

Preston Blair's ten shapes (Papagayo, xLights) are the common ground. Rhubarb has the letters A to H
and X; its own switch data maps them so. Phonemes, in ARPABET (with or without stress) or IPA, are
mapped as animators do: by what the lips show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

BLAIR: Final = ("AI", "E", "etc", "FV", "L", "MBP", "O", "rest", "U", "WQ")
"""Open; wide; most consonants; lip under the teeth; tongue up; lips closed; round; at rest;
pursed; pursed more."""

RHUBARB: Final[Mapping[str, str]] = {
    "A": "MBP", "B": "etc", "C": "E", "D": "AI", "E": "O", "F": "U", "G": "FV", "H": "L",
    "X": "rest",
}  # fmt: skip

INSTEAD: Final[Mapping[str, tuple[str, ...]]] = {
    "rest": ("MBP",), "MBP": ("rest",), "FV": ("MBP", "rest"), "L": ("E",), "WQ": ("U", "O"),
    "U": ("WQ", "O"), "etc": ("E",), "O": ("U",), "E": ("etc", "AI"), "AI": ("E",),
}  # fmt: skip
"""What is taken where a robot does not have a shape; as far as Rhubarb has optional shapes, its
own choice."""

_ARPABET: Final[Mapping[str, str]] = {
    "AI": "AA AE AH AW AX AY",
    "E": "EH ER EY IH IX IY AXR",
    "O": "AO OW OY",
    "U": "UH UW UX",
    "WQ": "W",
    "MBP": "B M P",
    "FV": "F V",
    "L": "L EL",
    "etc": "CH D DH DX EN G HH JH K N NG R S SH T TH Y Z ZH Q",
    "rest": "SIL SP SPN PAU",
}
ARPABET: Final = {phone: shape for shape, row in _ARPABET.items() for phone in row.split()}

_IPA: Final[Mapping[str, str]] = {
    "AI": "aɑæʌɐ{",
    "E": "eɛiɪəɜɚɝɘɨᵻ@",
    "O": "oɔɒɵ",
    "U": "uʊɯyʏøœʉ",
    "WQ": "wʍɥ",
    "MBP": "bmpɓ",
    "FV": "fvɱʋ",
    "L": "lɫɭʎ",
    "etc": "cdðɖɾɡgɣhɦjkçxχnŋɲɳqrɹɻʀʁsʃʂʒzʐtθʈʔʝɟβɸ",
}
IPA: Final = {sound: shape for shape, row in _IPA.items() for sound in row}
_MARKS: Final = "ˈˌːˑ.'̯̩̃͡ʰʲʷ̥"
"""Stress, length and other marks, which say nothing about the lips."""
IPA_MAX_CHARS: Final = 2
"""Letters of a diphthong or an affricate; a longer label is a word."""


def shape_reader(labels: Iterable[str]) -> Callable[[str], str] | None:
    """Return the function from label to shape of `BLAIR` that knows all labels; None if none does.

    An empty label is a mouth at rest.
    """
    known = {label for label in labels if label}
    for reader in (_rhubarb, _blair, _arpabet, _ipa):
        if known and all(map(reader, known)):
            return lambda label: reader(label) if label else "rest"
    return None


def _rhubarb(label: str) -> str:
    return RHUBARB.get(label, "")


def _blair(label: str) -> str:
    return next((shape for shape in BLAIR if shape.lower() == label.lower()), "")


def _arpabet(label: str) -> str:
    return ARPABET.get(label.rstrip("012").upper(), "")


def _ipa(label: str) -> str:
    bare = [char for char in label if char not in _MARKS]
    if not 1 <= len(bare) <= IPA_MAX_CHARS or not all(char in IPA for char in bare):
        return ""
    return IPA[bare[0]]


def robot_shapes(names: Collection[str]) -> dict[str, str]:
    """Return the names of a robot's visemes by the shape of `BLAIR` that they mean.

    They are names of Rhubarb if all are, else those of Blair; other names mean no shape.
    """
    reader = _rhubarb if all(name in RHUBARB for name in names) else _blair
    return {shape: name for name in names if (shape := reader(name))}


def nearest(shape: str, shapes: Mapping[str, str]) -> str | None:
    """Return the name among `shapes` of a shape, or of what is taken instead; None: neither."""
    return next((shapes[one] for one in (shape, *INSTEAD[shape]) if one in shapes), None)
