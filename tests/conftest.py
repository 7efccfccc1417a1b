"""Standing here, it lets tests of all folders import what they share from this one."""
