"""Jobs and what they amount to: subjects, shots, cameras."""
