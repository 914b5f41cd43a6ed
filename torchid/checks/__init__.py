"""What is wrong with recordings, before any fit: each file, its plates, its marker tracks, forces against feet."""
