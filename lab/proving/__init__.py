"""Proving ground: made captures with exact truth, and how gsut does on captures nobody tuned on."""
