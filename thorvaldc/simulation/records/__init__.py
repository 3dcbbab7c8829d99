"""Records of runs: MCAP files, CSV files and joint logs.

A recorder gets the samples of ``control_loop`` and writes them.  ``joint_csv`` writes and reads
the encoder readings for a calibration.  Begin with ``recorder``.
"""
