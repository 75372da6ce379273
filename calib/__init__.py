"""From photographs of a chessboard to a lens file; run as `python -m calib JOB.json`.

Talks to gsut through lens files and its public names only; gsut starts it as a subprocess.
"""
