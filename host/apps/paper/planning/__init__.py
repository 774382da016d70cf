"""What the paper measures of planning (section V-B and the flights of VI-D), and what it leaves open."""
