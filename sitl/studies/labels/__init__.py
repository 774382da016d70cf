"""The study of labels: Neural-C learned from smoothed logs, and from the plant's own acceleration."""
