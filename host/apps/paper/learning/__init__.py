"""What the paper measures of learning (sections V-A, VI-B and VI-C), and what it leaves open."""
