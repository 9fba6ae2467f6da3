"""Terms of the sum that training minimizes: losses and regularizers, one file a term (`method/train/losses.py` lists them)."""
