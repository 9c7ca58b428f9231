"""The errors that a user can meet; the command line turns `exit_code` into the exit status."""

import math
import numbers
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

LONGEST_MESSAGE = 10_000
_MOST_SHOWN = 50  # problems in one message


def shown(value: object) -> str:
    """A value about as the user wrote it, in at most 80 characters."""
    try:
        text = repr(value)
    except ValueError:  # Python prints no whole number of more than 4300 digits
        return "a number of thousands of digits"
    except RecursionError:
        return "a value nested too deep to show"
    return text if len(text) <= 80 else f"{text[:77]}..."


def did_you_mean(found: object, known: Iterable[str], least: float = 0.6) -> str:
    """What may be said behind a name that is not known: "; did you mean X?", or nothing where none is close.

    `least`: share of the letters that are alike, as difflib counts them."""
    close = get_close_matches(str(found), list(known), 1, least)
    return f"; did you mean {close[0]}?" if close else ""


def _printable(message: str) -> str:
    """The message with control characters escaped, because names from a file may hold them, and of bounded length."""
    if len(message) > LONGEST_MESSAGE:
        message = f"{message[:LONGEST_MESSAGE]} ... and {len(message) - LONGEST_MESSAGE} letters more"
    return "".join(letter if letter.isprintable() or letter == "\n" else repr(letter)[1:-1] for letter in message)


class WarpsarError(Exception):
    """The command ran, and its result is a failure that the user asked to hear of."""

    exit_code = 1
    quiet = False  # true in all but one of several processes that fail together

    def __init__(self, message: str = "") -> None:
        super().__init__(_printable(message))


class InputError(WarpsarError):
    """Bad input or usage: one message that names the file, the key, the value found and what is allowed."""

    exit_code = 2


class NothingLitError(InputError):
    """No pixel of an image is lit by the model, unmasked and positive at once."""


class NothingShownError(InputError):
    """A radar product shows no ground of an elevation model."""


class DeviceError(WarpsarError):
    """The device that was asked for is not there."""

    exit_code = 3


def listed(where: object, problems: Sequence[str]) -> str:
    """One message for all that is wrong at a place; there is something."""
    if len(problems) == 1:
        return f"{where}: {problems[0]}"
    more = [f"and {len(problems) - _MOST_SHOWN} more"] if len(problems) > _MOST_SHOWN else []
    return "\n  ".join([f"{where}: {len(problems)} things are wrong", *problems[:_MOST_SHOWN], *more])


def refuse_number(value: object, where: str, *, whole: bool = False, low: float = 0.0, above: bool = False) -> None:
    """Raise InputError for what is no number from `low` on, or `above` it; `whole`: no whole one. Infinity is one."""
    kind = numbers.Integral if whole else numbers.Real
    sound = isinstance(value, kind) and not isinstance(value, bool) and not math.isnan(value)
    if not sound or not (value > low if above else value >= low):  # type: ignore[operator]
        bound = f"above {low:g}" if above else f"from {low:g} on"
        raise InputError(f"{where}: found {shown(value)}; must be a {'whole ' * whole}number {bound}")


def refuse_kind(value: object, kind: type, where: str) -> None:
    """Raise InputError for what is no `kind`, a class of the package's own."""
    if not isinstance(value, kind):
        raise InputError(f"{where}: found {shown(value)}; must be a warpsar.{kind.__name__}")
