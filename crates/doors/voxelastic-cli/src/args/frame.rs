//! Where what is added to a map lies in it.

use clap::Args;
use voxelastic_run::joining::Frame;

/// Arguments about where a session lies in a map.
#[derive(Clone, Copy, Debug, Args)]
pub struct AlignArgs {
    /// About where the frame of what is added lies in the map (right to within some metres): its origin, metres, and its yaw, degrees; or x y z qx qy qz qw.
    /// 0,0,0 says that it has the map's frame. What lies nowhere near a surface of the map is added only with this [default: the same frame if that fits,
    /// else where places are recognised]
    #[arg(long, value_name = "X,Y,Z[,YAW]", value_parser = Frame::parse, allow_hyphen_values = true, hide_short_help = true)]
    pub align: Option<Frame>,
}
