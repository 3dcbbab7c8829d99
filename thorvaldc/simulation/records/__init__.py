"""Reading and writing of recorded runs: MCAP files, CSV files and joint logs."""
