"""`lab/run attack`: bad input to every command and reader; commands killed at random moments."""
