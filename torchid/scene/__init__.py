"""The body in three dimensions, on a page that a browser shows: live, of a finished run, and inside a report."""
