"""From a robot document and its module types to the model: resolution, hardware, elaboration."""
