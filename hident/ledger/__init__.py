"""The printed numbers of the papers, and the comparison of results with them and with each other."""
