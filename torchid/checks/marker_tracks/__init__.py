"""What is wrong with the tracks of markers, told by the distances between markers that one segment carries."""
