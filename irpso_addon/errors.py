"""The exceptions that cross a border of the program; each message names what is wrong, where, and the remedy."""


class IrpsoError(Exception):
    """Base of every error meant for the person at the keyboard; ``exit_code`` is what the command line returns."""

    exit_code = 1


class InputError(IrpsoError):
    """A file, folder, mesh or setting that cannot be used. Nothing has been written."""

    exit_code = 2


class ShaderError(InputError):
    """A shader does not compile. ``log`` holds the driver's own lines, with file and line of the .glsl source."""

    def __init__(self, message: str, log: str = ""):
        super().__init__(message if not log else f"{message}\n{log}")
        self.log = log


class GpuUnavailableError(IrpsoError):
    """No usable GPU context can be made, or the device computes wrongly."""

    exit_code = 3
