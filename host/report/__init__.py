"""Reports: one HTML file, offline, with its figures and the numbers behind them inside."""
