"""The laboratory: it measures, attacks and proves the installed gsut."""
