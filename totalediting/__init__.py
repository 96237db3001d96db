"""What is learnt: the portrait model that trains on the emitted shards."""
