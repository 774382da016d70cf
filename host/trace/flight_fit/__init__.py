"""Fits of sets of effects to whole flights in closed loop, and the repeatability of their residuals."""
