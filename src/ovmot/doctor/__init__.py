"""What is wrong or doubtful in a recorded sequence, found before anyone runs it."""
