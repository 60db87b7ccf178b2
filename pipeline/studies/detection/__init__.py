"""Detection: public finders on rendered frames, judged by the truth."""
