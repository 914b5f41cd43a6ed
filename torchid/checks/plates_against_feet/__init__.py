"""Whether forces agree with feet: what a recording's plates say against what its markers show, before any fit."""
