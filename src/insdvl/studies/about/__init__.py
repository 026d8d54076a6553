"""What the software says of itself: models, parameters, installation, citation, completion."""
