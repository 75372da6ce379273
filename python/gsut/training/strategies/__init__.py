"""Strategies of densification, one a file, found by their names: strategy NAME is NAME.py."""
