"""Where a stream comes from: recordings, Lab Streaming Layer, Qualisys, XDF; what arrives, and when."""
