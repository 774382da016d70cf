"""Import of foreign flight logs. Frames, units and clocks are converted here and nowhere else."""

from trimtab.host.imports.recording import ImportFormatError, Recording

__all__ = ["ImportFormatError", "Recording"]
