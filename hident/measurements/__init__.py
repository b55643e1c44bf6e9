"""Records of measurements: files of samples, what is done to them before they are used, a first look."""
