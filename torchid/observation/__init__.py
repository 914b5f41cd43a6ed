"""A followed trial as evidence: residuals, noise, and how the motion answers to displaced markers."""
