"""What a recording says of its laboratory almost without a body: statistics that any cause has to agree with."""
