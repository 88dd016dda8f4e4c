//! The sensor (paper Sec. III): beam model, range image, normals, pyramid.
