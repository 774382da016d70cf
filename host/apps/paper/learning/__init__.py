"""The paper's measurements of learning (sections V-A, VI-B and VI-C), and further ones."""
