"""Reports: each is one HTML file that opens offline and contains its figures and their data."""

import logging

# Without a writable cache folder, matplotlib uses a temporary one and warns about it.
logging.getLogger("matplotlib").setLevel(logging.ERROR)
