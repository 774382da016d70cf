"""Sets of effects fitted to whole flights over the closed loop, and what repeats between twins."""
