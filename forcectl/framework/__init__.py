"""What blocks are made of: sampling, parameters, batches, caches, rotations."""
