"""Every refusal a user can meet; the command line turns `exit_code` into the exit status."""

LONGEST_MESSAGE = 10_000


def shown(value: object) -> str:
    """A value as a user wrote it, more or less, and not too much of it."""
    try:
        text = repr(value)
    except ValueError:  # Python prints no whole number of more than 4300 digits
        return "a number of thousands of digits"
    except RecursionError:
        return "a value nested too deep to show"
    return text if len(text) <= 80 else f"{text[:77]}..."


def _printable(message: str) -> str:
    """Names from a file may hold what steers a terminal: it is escaped, and no message is endless."""
    if len(message) > LONGEST_MESSAGE:
        message = f"{message[:LONGEST_MESSAGE]} ... and {len(message) - LONGEST_MESSAGE} letters more"
    return "".join(letter if letter.isprintable() or letter == "\n" else repr(letter)[1:-1] for letter in message)


class WarpsarError(Exception):
    """It ran, and the result is a failure the user asked to be told of."""

    exit_code = 1
    quiet = False  # of several processes that refuse together, one speaks

    def __init__(self, message: str = "") -> None:
        super().__init__(_printable(message))


class InputError(WarpsarError):
    """Bad input or usage: one message that names file, key, value found and what is allowed."""

    exit_code = 2


class DeviceError(WarpsarError):
    """The device asked for is not there."""

    exit_code = 3
