"""Counts what is read of Gaussians that stay in their file."""

from gsut.gaussians import StoredGaussians


def count_reads(monkeypatch):
    """Rows that are read from now on, one number a call."""
    reads, read = [], StoredGaussians._read

    def counted(self, pieces):
        out = read(self, pieces)
        reads.append(len(out))
        return out

    monkeypatch.setattr(StoredGaussians, "_read", counted)
    return reads
