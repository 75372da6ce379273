"""Catches wrong input: every error of gsut derives from ValueError or RuntimeError."""

import gsut

try:
    gsut.load_dataset("no such folder")
except gsut.InputError as error:
    print(error)  # what is wrong, and what to do
