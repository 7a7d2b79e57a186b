"""What is wrong or doubtful in a recorded sequence, told before anyone runs it."""
