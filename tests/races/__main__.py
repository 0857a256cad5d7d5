"""`python -m races races | order GROUP CACHE` prints the results as JSON."""

import json
import sys

import warp as wp

from races.launches import races
from races.order import apart

ASKED = {"races": races, "order": apart}

if __name__ == "__main__":
    wp.config.log_level = wp.LOG_ERROR
    what, group, cache = sys.argv[1:]
    print(json.dumps(ASKED[what](group, cache)))
