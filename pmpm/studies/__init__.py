"""Studies: a scene refined level by level in several schemes, its error and what that costs."""
