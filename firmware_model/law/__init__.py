"""The control law, shared by firmware and host: one source for floats, CasADi symbols and numpy lanes."""
