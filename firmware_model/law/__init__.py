"""What vehicle and host must compute alike: one source for floats, CasADi symbols and numpy lanes."""
