"""From the packets of a stream to postures, rows and the estimate."""
