"""The paper's own set-ups, measured again: data, tables and pictures beside the numbers it gives."""
