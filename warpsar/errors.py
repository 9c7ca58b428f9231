"""Every refusal a user can meet; the command line turns `exit_code` into the exit status."""


class WarpsarError(Exception):
    """It ran, and the result is a failure the user asked to be told of."""

    exit_code = 1


class InputError(WarpsarError):
    """Bad input or usage: one message that names file, key, value found and what is allowed."""

    exit_code = 2


class DeviceError(WarpsarError):
    """The device asked for is not there."""

    exit_code = 3
