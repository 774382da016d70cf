"""Reports: one HTML file, offline, with its figures and the numbers behind them inside."""

import logging

# Where its cache cannot be kept, as without a home, matplotlib makes do with a temporary one and says so.
logging.getLogger("matplotlib").setLevel(logging.ERROR)
