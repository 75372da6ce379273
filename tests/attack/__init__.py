"""`./run attack`: bad inputs to every command and reader, and commands killed at random moments."""
