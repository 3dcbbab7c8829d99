"""Records of runs: MCAP files, CSV files, and the joint logs of calibrations."""
