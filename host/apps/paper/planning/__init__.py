"""The paper's measurements of planning (section V-B and the flights of VI-D), and further ones."""
