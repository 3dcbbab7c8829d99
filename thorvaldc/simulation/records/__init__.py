"""Reading and writing of recorded runs: MCAP files, CSV files and joint logs.

A recorder gets the samples of ``control_loop`` and writes them; a reader returns a
``RecordedRun``.  ``joint_csv`` has the encoder readings for a calibration.  Begin with
``recorder`` and ``record_reader``.
"""
