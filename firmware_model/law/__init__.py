"""The control law, shared by firmware and host: one source for floats, CasADi symbols and numpy arrays.

numpy arrays have one entry for each independent vehicle (lane). "Paper" in this package is K. Guo, Z. Yang et
al., "Optimizing Control-Friendly Trajectories with Self-Supervised Residual Learning".
"""
