"""The paper's comparison of controllers and trajectories (sections V-B, V-C and VI-D), and its limits."""
