"""The paper's protocols, and their scores."""
