"""Every effect of the catalogue plants itself in a recording and predicts what it does there."""
