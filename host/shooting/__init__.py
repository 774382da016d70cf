"""Multiple shooting: problems over many intervals, their derivatives in C or CasADi, and their solvers."""
