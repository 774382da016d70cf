"""Foundations of the host: errors with exit codes, output, progress, artefacts, resumable studies."""
