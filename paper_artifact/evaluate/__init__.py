"""How far a reconstruction is from its ground truth: diagrams, point-set distances, image scores.

Imports neither the trainer nor the scenes: point arrays and images in, numbers out.
"""
