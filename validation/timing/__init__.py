"""What a control step costs, and how that is measured."""
