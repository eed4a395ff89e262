"""Numbers that no parameter takes."""

import math

BAD_NUMBERS = [math.nan, math.inf, -math.inf, "1", None, True, [1.0]]
