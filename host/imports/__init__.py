"""Foreign flight logs brought into the project's own: frames, units and clocks are converted here and
nowhere else.
"""

from trimtab.host.imports.recording import ImportFormatError, Recording

__all__ = ["ImportFormatError", "Recording"]
