//! Arguments that several commands have.

mod body;
mod corrections;
pub mod data;
mod frame;
pub mod images;
mod load;
pub mod raw_data;
mod resume;
mod save;
pub mod settings;

pub use body::BodyArgs;
pub use corrections::CorrectionArgs;
pub use data::{DataArgs, ReadingArgs};
pub use frame::AlignArgs;
pub use load::LoadArgs;
pub use resume::ResumeArgs;
pub use save::SaveArgs;
pub use settings::SettingFlags;
