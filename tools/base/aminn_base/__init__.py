"""What all Python packages of the project stand on; imports none of them."""
