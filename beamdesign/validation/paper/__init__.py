"""Zalucky and Hardt (1984): the published rig as a prototype, and every published number beside the model's."""
