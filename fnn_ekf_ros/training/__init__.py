"""Learning of the membership functions by steepest descent (Nguyen et al., eqs. 23 and 24)."""
