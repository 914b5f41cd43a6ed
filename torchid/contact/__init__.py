"""Which foot stands where: frames whose support no plate measures, and the plate under each foot."""
