"""Single shots and subjects: members read by offset, decoded, drawn small, lit, beside a run."""
